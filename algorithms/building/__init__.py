"""All scans together: walls, doors, windows, floors, ceilings, and each return's final label.

`fusion` calls the steps in order, on the types of `model`: `evidence` books rays in cells of faces,
`parse` divides faces into stretches, `settle` decides which of them are walls.
"""
