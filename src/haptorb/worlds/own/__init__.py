"""Worlds that users write: functions, files that are loaded, and what is said when their code fails."""
