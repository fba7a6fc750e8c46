"""HTML pages: everything that people look at after an inspection."""
