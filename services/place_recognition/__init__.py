"""Place recognition: follows the keyframe log, finds loop candidates and lends them as jobs."""
