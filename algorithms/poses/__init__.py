"""Where the robot was: odometry (paper, IV.A), its refinement, loops closed, and which way is up."""
