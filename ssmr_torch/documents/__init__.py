"""The numbers that the documentation prints: stored with the command that measured them, and written into the pages."""
