"""Files that people write and read: text, TOML and JSON of bounded size, with errors that name the place."""
