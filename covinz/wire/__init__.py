"""The layout of the messages on the wire, generated from schemas/*.fbs."""
