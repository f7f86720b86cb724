"""What ingest says and does while it cannot store: full disk, damaged file."""

from __future__ import annotations

import logging
from collections import Counter

from covinz.config import IngestConfig
from covinz.damage import Trouble
from covinz.types import RetryAfter
from services.ingest.keyframe_log import LogUnavailable

logger = logging.getLogger(__name__)


class StoreTrouble:
    """Said once when it begins and once when it ends; a flood of uploads must not fill the logs.

    A full disk is tried again with every upload that comes. Nothing more is written to a damaged
    file: what is in it is still handed out.
    """

    def __init__(self, config: IngestConfig) -> None:
        self._retry_after_s = config.trouble_retry_after_s
        self._trouble: Trouble | None = None
        self._failed_commits = 0
        self._refused = 0

    @property
    def counters(self) -> Counter[str]:
        """``failed_commits`` since the start, and ``cannot_store.<trouble>``: 1 while it lasts."""
        found = Counter({"failed_commits": self._failed_commits})
        if self._trouble is not None:
            found[f"cannot_store.{self._trouble.value}"] = 1
        return found

    def refusal(self) -> RetryAfter | None:
        """The answer to every upload, if there is no use in trying to store it."""
        return self._answer() if self._trouble is Trouble.DAMAGED else None

    def begin(self, error: LogUnavailable, num_uploads: int) -> RetryAfter:
        """A commit of so many uploads failed; the answer to each."""
        self._failed_commits += 1
        self._refused += num_uploads
        if self._trouble is not error.trouble:
            logger.error(
                "uploads are not stored, and robots keep them: %s",
                f"{error}. Restore a backup (covinz restore)"
                if error.trouble is Trouble.DAMAGED
                else error,
            )
        self._trouble = error.trouble
        return self._answer()

    def end(self) -> None:
        """A commit succeeded."""
        if self._trouble is not None:
            logger.warning("uploads are stored again; %d had been put off", self._refused)
            self._trouble, self._refused = None, 0

    def _answer(self) -> RetryAfter:
        assert self._trouble is not None
        return RetryAfter(self._retry_after_s, self._trouble.words)
