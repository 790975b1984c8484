"""Maps of the building: the furniture-free grid and the paper's rivals (IV.C), rooms (IV.D), the floor plan."""
