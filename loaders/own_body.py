"""The robot's own body in a bag's clouds: found once, and removed from every scan."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.own_body import find_own_body, moves
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.bag import Bag
from ffmap.loaders.decoding import decode
from ffmap.loaders.errors import CloudError
from ffmap.loaders.rig import Lidar, Rig
from ffmap.loaders.scans import sample_messages

_CLOUDS = 24
"""Number of clouds, spread over the bag: returns in nine of ten of them move with the robot."""


def without_own_body(bag: Bag, rig: Rig) -> Rig:
    """Remove the robot's own body from the scans of a rig; a warning describes it."""
    lidars = {lidar.topic: lidar for lidar in (rig.horizontal, *rig.verticals) if lidar is not None}
    clouds = {topic: _sample(bag, lidar) for topic, lidar in lidars.items()}
    if not any(map(moves, clouds.values())):
        return rig
    warnings = []
    for topic, lidar in lidars.items():
        body = find_own_body(clouds[topic], lidar.T_base_sensor)
        if body is None:
            continue
        points_base = transforms.apply(lidar.T_base_sensor, body.points_sensor)
        low_m, high_m = points_base.min(axis=0), points_base.max(axis=0)
        size = " x ".join(f"{m:.2f}" for m in high_m - low_m)
        warnings.append(
            f"{topic} sees the robot itself: {body.share:.1%} of its returns are removed, {size} m "
            f"about {np.round((low_m + high_m) / 2, 2).tolist()} in "
            f"{rig.base_frame or 'its own frame'}; --set scan.own_body=false keeps them"
        )
        lidars[topic] = replace(lidar, decoding=replace(lidar.decoding, own_body=body))
    return replace(
        rig,
        horizontal=lidars[rig.horizontal.topic] if rig.horizontal else None,
        verticals=tuple(lidars[lidar.topic] for lidar in rig.verticals),
        warnings=(*rig.warnings, *warnings),
    )


def _sample(bag: Bag, lidar: Lidar) -> list[FloatArray]:
    clouds = []
    for message in sample_messages(bag, lidar.index(bag), _CLOUDS):
        with suppress(CloudError):
            clouds.append(decode(message, lidar.decoding).points_sensor)
    return [cloud for cloud in clouds if len(cloud)]
