"""Telling other services how jobs ended: where to, signed how, and sent by whom."""
