"""Force maps over a dome: summits, valleys, terrain."""
