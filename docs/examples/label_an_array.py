"""Label one revolution of a lidar that is a NumPy array, and ask for reasons.

    python docs/examples/label_an_array.py drive.bag /vertical_velodyne/velodyne_points 0,1,0

The array may come from anywhere; here it is the first cloud of a bag. The last argument is the
upright direction in the sensor's frame: 0,0,1 for an upright lidar, which is the default.
"""

import sys

import rerun as rr

import ffmap

bag, *more = sys.argv[1:]
topic = more[0] if more else None
up = tuple(float(value) for value in more[1].split(",")) if len(more) > 1 else (0.0, 0.0, 1.0)

scan = next(ffmap.read_scans(bag, topic))
points, ring = scan.points_sensor, scan.ring  # (n, 3) in metres, (n,)

labelled = ffmap.label_scan(points, ring, up)
print(labelled)  # how many points of each label; labelled.label has one for each point
walls = points[labelled.label == ffmap.Label.WALL]
print(f"{len(walls):,} of {len(points):,} points are on walls")

planes = labelled.labelling.planes  # every intermediate of the method is kept
for plane in range(len(planes)):
    normal, lines = planes.normal[plane].round(3), planes.line_count[plane]
    print(f"wall plane: normal {normal}, {planes.offset_m[plane]:.2f} m away, {lines} point lines")

refused = (reason for reason in labelled.reasons if reason.outcome.name == "REFUSED")
line = next(refused, None)
if line is not None:
    print(f"line {line.line} is in no wall: {line.sentence}")
    for condition in line.conditions:
        print(f"    {condition}")

rr.init("label_an_array")
rr.save("labelled.rrd")
labelled.log(rr)
print("labelled.rrd has all of it, line by line: rerun labelled.rrd")
