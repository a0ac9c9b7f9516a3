"""The study in the browser: a page for the participant and one for the experimenter, apart."""
