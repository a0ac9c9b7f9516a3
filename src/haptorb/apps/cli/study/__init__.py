"""`haptorb study`: perceptual studies from the file to the data."""

from haptorb.apps.cli.study.command import register

__all__ = ["register"]
