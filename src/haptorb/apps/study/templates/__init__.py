"""Study files to begin with, and the comments that explain their keys."""
