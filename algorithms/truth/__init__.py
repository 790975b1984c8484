"""Results compared with the ground truth, and runs compared with each other."""
