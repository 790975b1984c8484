"""Maps of a building: grids (paper, IV.C), rooms (IV.D) and the floor plan."""
