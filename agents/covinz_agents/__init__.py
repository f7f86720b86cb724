"""Front-ends that play a robot: recorded data sets and generated worlds."""
