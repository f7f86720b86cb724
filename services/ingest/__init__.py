"""Ingest: the process that owns the keyframe log."""
