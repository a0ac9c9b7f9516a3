"""Sessions in which designs are felt and rated, as the console shows them."""
