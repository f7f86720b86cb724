"""The hub that all sessions connect to: routing, who may connect, a limit on messages."""
