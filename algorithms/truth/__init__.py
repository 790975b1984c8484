"""Results against the truth, or against each other: labels by area (paper, IV.B, eq. 3), doors, maps, rooms, runs."""
