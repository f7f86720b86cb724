"""Checks that are too large for the test suites; each says in its first lines what it needs."""
