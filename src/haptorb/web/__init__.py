"""Browser pages: the console, the player of recordings, and the server that they share."""
