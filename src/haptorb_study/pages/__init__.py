"""Pages of a study in the browser: the participant's and the experimenter's."""
