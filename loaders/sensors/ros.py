"""PointCloud2 of any maker's driver."""

from ffmap.loaders.pointcloud2 import CLOUD_TYPE
from ffmap.loaders.sensors.sensor import Sensor


class PointCloud2(Sensor):
    """PointCloud2 of any driver: `settle_decoding` finds fields, units and rings by content."""

    messages = "PointCloud2"
    msgtypes = (CLOUD_TYPE,)
