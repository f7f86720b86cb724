"""The hub that all sessions connect to: routing, and a limit on the size of messages."""
