"""Pages in the browser: the console, the player of recordings, and the server that they share."""
