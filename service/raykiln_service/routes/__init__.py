"""The HTTP handlers: thin, and ignorant of how and where jobs are rendered."""
