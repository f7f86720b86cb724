"""covinz: what two or more of its processes share, installable on a robot (pure Python)."""
