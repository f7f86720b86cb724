"""Front-ends that play a robot: recorded data sets and a simulated world."""
