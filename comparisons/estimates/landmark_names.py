"""Landmarks' names in an estimate's files, and the numbers that the log has for them.

A file names a landmark by the log's label of it or by its number in the log; a block of a filter's
trace ends in either. `LandmarkNames` translates both, for `ExternalEstimate.numbered_as`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from comparisons.errors import shorten

_WHOLE = re.compile(r"-?\d{1,18}", re.ASCII)
_LAST_NUMBER = re.compile(r"(?:.*\D)?(\d{1,18})", re.ASCII | re.DOTALL)

_NAMELESS = 1 << 52
"""From here on there are numbers of blocks that end in no name."""


class LandmarkNames:
    """Numbers of landmarks by what an estimate and its trace call them.

    Words are all labels, or all numbers of the log: whichever the log has more of, and labels where
    it has as many of both. Labels that the log lacks get further numbers.
    """

    def __init__(self, labels: Mapping[int, str], words: Sequence[str] | Sequence[int]) -> None:
        """labels: of the log, by number. words: (L,) of a file, or numbers of the log."""
        self._by_label = {label: number for number, label in labels.items()}
        self._words = [str(word) for word in words]
        numbers = [int(word) for word in words if isinstance(word, int) or is_whole(word)]
        in_log = sum(number in labels for number in numbers)
        labelled = sum(word in self._by_label for word in words)
        text = len(numbers) < len(words)
        self.are_labels = bool(labels) and (text or labelled >= max(in_log, 1))
        if self.are_labels:
            free = max(labels) + 1
            for word in self._words:
                if word not in self._by_label:
                    self._by_label[word], free = free, free + 1
            numbers = [self._by_label[word] for word in self._words]
        self.numbers = numbers

    def called(self, place: int) -> str:
        """Return what the estimate calls a landmark, as a message quotes it."""
        return shorten(self._words[place])

    def of_blocks(self, blocks: Sequence[str]) -> list[int | None]:
        """Return the numbers (B,) of the landmarks of a trace's blocks, None for none.

        They are read as the estimate's words, unless more of them are landmarks the other way.
        """
        known = set(self.numbers)
        readings = [
            [self._label_at_end(block) for block in blocks],
            [_number_at_end(block) for block in blocks],
        ]
        readings = [[n if n in known else None for n in reading] for reading in readings]
        return min(readings if self.are_labels else readings[::-1], key=lambda r: r.count(None))

    def of_removed(self, blocks: Sequence[str]) -> tuple[int, ...]:
        """Return the numbers of landmarks that the estimate no longer holds, by their blocks.

        A block that ends in no name has a number that no landmark has.
        """
        found: list[int] = []
        for block in blocks:
            number = self._label_at_end(block) if self.are_labels else _number_at_end(block)
            found.append(_NAMELESS + len(found) if number is None else number)
        return tuple(found)

    def _label_at_end(self, block: str) -> int | None:
        """The number of the longest label that ends a block and cuts no word or number in two."""
        for begin in range(len(block)):
            number = self._by_label.get(block[begin:])
            if number is not None and (begin == 0 or not _is_within(block[begin - 1 : begin + 1])):
                return number
        return None


def is_whole(word: str) -> bool:
    """Return whether a word is a whole number that may name a landmark."""
    return _WHOLE.fullmatch(word) is not None


def _number_at_end(block: str) -> int | None:
    match = _LAST_NUMBER.fullmatch(block)
    return None if match is None else int(match[1])


def _is_within(pair: str) -> bool:
    """Whether two characters belong to one word or one number."""
    return pair.isalpha() or pair.isdigit()
