"""Loop solver: takes jobs from place recognition and verifies them with the numeric core."""
