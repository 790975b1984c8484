"""Log an intermediate of one's own beside those of a scan: how far each return is from its plane.

    python docs/examples/log_an_intermediate.py drive.bag /vertical_velodyne/velodyne_points 0,1,0

To log it for every scan of every run, put the same calls into `log_scan` in app/record/scans.py.
"""

import sys

import numpy as np
import rerun as rr

import ffmap

bag, topic, up = sys.argv[1:]
scan = next(ffmap.read_scans(bag, topic))
labelled = ffmap.label_scan(
    scan.points_sensor, scan.ring, tuple(float(value) for value in up.split(","))
)
labelling, points = labelled.labelling, labelled.level.placed.points_level

on_plane = labelling.plane >= 0  # the wall plane of each return, -1 for none
plane = labelling.plane[on_plane]
normal, offset_m = labelling.planes.normal[plane], labelling.planes.offset_m[plane]
off_mm = 1e3 * (np.einsum("ij,ij->i", points[on_plane, :2], normal) - offset_m)
print(f"{on_plane.sum():,} returns on planes, scatter {off_mm.std():.1f} mm")

rr.init("off_plane")
rr.save("off_plane.rrd")
labelled.log(rr)
shade = np.clip(128 + 4 * off_mm, 0, 255).astype(np.uint8)
colors = np.column_stack([shade, 255 - shade, np.full_like(shade, 128)])
rr.log(
    "/scan/off_plane",
    rr.Points3D(points[on_plane], colors=colors, radii=0.01),
    rr.AnyValues(off_mm=off_mm.astype(np.float32)),
    static=True,
)
print("off_plane.rrd: the entity /scan/off_plane")
