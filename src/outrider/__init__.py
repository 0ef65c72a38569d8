"""Raw 2D lidar scans in; tracked vehicles, times to collision and warnings out."""

__version__ = "0.1.0"
