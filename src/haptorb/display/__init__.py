"""What a notebook shows of a value: numbers with their units, small tables and curves, as text and as HTML."""
