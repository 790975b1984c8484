"""Map a bag from Python, and use the building.

python docs/examples/map_a_bag.py drive.bag runs/a
"""

import sys

import ffmap

bag, out = sys.argv[1:]
run = ffmap.map_building(bag, {"wall_planes.similarity_m": 0.04}, out=out)

print(run)
for door in run.doors.to_pylist():
    print(f"{door['state']} door, {door['width']:.2f} m wide, between {door['rooms']}")
for room in run.rooms.to_pylist():
    beside = ", ".join(room["neighbours"]) or "none"
    print(f"{room['name']}: {room['area']:.1f} m², beside {beside}")

points, label = run.cloud
print(f"{len(points):,} points of the building, {(label == ffmap.Label.WALL).mean():.0%} wall")
cells, cell_m = run.grid.cells, run.grid.cell_m
print(f"grid of {cells.shape[1]} × {cells.shape[0]} cells of {100 * cell_m:.0f} cm")
if "wall.f1" in run.figures:
    print(f"wall F1 {100 * run.figures['wall.f1']:.2f} %, by the ground truth in the bag")
