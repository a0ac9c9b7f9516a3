"""`haptorb design`: search for devices."""

from haptorb.apps.cli.design.command import register

__all__ = ["register"]
