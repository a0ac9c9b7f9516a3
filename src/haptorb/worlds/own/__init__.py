"""Worlds that users write: functions, loaded files, and messages when their code fails."""
