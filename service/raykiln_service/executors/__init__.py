"""Where units are rendered.  The dispatcher knows `base.Executor` only."""
