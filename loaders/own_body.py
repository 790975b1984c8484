"""The robot's own body in a bag's clouds: found once, and left out of every scan that is read."""

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
"""Number of clouds, spread over the bag, that show the body: what is beside the robot in nine of ten of them moves with it."""


def without_own_body(bag: Bag, rig: Rig) -> Rig:
    """The same lidars, whose scans lack the robot's own body; a warning says what was found."""
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
        warnings.append(
            f"{topic} sees the robot itself: {body.share:.1%} of its returns are left out, "
            f"{' x '.join(f'{m:.2f}' for m in high_m - low_m)} m about {np.round((low_m + high_m) / 2, 2).tolist()} in "
            f"{rig.base_frame or 'its own frame'}; --set scan.own_body=false keeps them"
        )
        lidars[topic] = replace(lidar, decoding=replace(lidar.decoding, own_body=body))
    horizontal = None if rig.horizontal is None else lidars[rig.horizontal.topic]
    verticals = tuple(lidars[lidar.topic] for lidar in rig.verticals)
    return replace(rig, horizontal=horizontal, verticals=verticals, warnings=(*rig.warnings, *warnings))


def _sample(bag: Bag, lidar: Lidar) -> list[FloatArray]:
    """Clouds (n, 3) from all over the bag, those that can be read."""
    clouds = []
    for message in sample_messages(bag, lidar.index(bag), _CLOUDS):
        try:
            clouds.append(decode(message, lidar.decoding).points_sensor)
        except CloudError:
            continue
    return [cloud for cloud in clouds if len(cloud)]
