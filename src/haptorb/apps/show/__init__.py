"""`haptorb show DEVICE`: a drawing of a device to scale, in section and in three dimensions."""

from __future__ import annotations

from haptorb.apps.show.description import describe_geometry
from haptorb.apps.show.drawing import VIEWS, draw_device

__all__ = ["VIEWS", "describe_geometry", "draw_device"]
