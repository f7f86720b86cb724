"""The optimizer: turns keyframes and verified loops into maps and corrections."""
