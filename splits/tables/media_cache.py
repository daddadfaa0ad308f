"""Cache of what the media of a table have in common under all incidences."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from splits.simulation.shared_paths import PathSharingMedia

Value = TypeVar("Value")


class MediaCache:
    """Cache of one value for the last media, since the incidences of media follow each other."""

    def __init__(self) -> None:
        self._media: PathSharingMedia | None = None
        self._value: object = None

    def get(self, media: PathSharingMedia, compute: Callable[[], Value]) -> Value:
        """Return the value of the media, computed unless they are the last ones.

        All calls of a cache must be for the same kind of value.
        """
        if media is not self._media:
            self._media, self._value = media, compute()
        return self._value  # type: ignore[return-value]
