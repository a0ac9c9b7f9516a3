"""`haptorb train`: networks from field to torque for one device, trained, judged and kept."""

from __future__ import annotations

from haptorb.apps.train.training import Training, train_networks

__all__ = ["Training", "train_networks"]
