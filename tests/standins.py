"""Networks that know the truth, to test what is around a network: chunks, patches, statuses, mappings."""

import cv2
import numpy as np

from vfm_sdm.networks.interface import ChunkTracks


def numbered(index, shape=(140, 140)):
    """A picture whose first two pixels carry its number."""
    picture = np.zeros((*shape, 3), dtype=np.uint8)
    picture[0, 0], picture[0, 1] = index % 256, index // 256
    return picture


class KnownMotion:
    """Moves every point by a motion that depends on the number in a picture alone.

    Parameters
    ----------
    motion
        From frame number to (u, v) [px].
    bias
        From the call's number to what all its positions are off by (u, v) [px].
    visibility
        From frame number to the visibility.
    fits
        Frames that fit memory; more raise `MemoryError`.
    plan
        What `plan_frames` answers.
    number
        From a patch (height, width, 3) to its frame number.
    """

    precision = "float32"

    def __init__(self, motion, *, bias=None, visibility=None, confidence=1.0, fits=None, plan=None, number=None):
        self.motion, self.bias, self.fits, self.plan = motion, bias, fits, plan
        self.visibility, self.confidence = visibility or (lambda i: 1.0), confidence
        self.number = number or (lambda patch: int(patch[0, 0, 0]) + 256 * int(patch[0, 1, 0]))
        self.calls = []

    def follow(self, frames, queries):
        if self.fits is not None and len(frames) > self.fits:
            raise MemoryError("no room")
        numbers = [self.number(frame) for frame in frames]
        self.calls.append((numbers, queries.copy(), frames.shape))
        moved = np.array([self.motion(i) for i in numbers]) - self.motion(numbers[0])
        off = np.zeros(2) if self.bias is None else np.asarray(self.bias(len(self.calls)))
        positions = queries + moved[:, None] + off
        seen = np.array([self.visibility(i) for i in numbers])[:, None]
        return ChunkTracks(positions, np.repeat(seen, len(queries), 1), np.full(positions.shape[:2], self.confidence))

    def plan_frames(self, height, width):
        return self.plan


def swaying(index):
    """A motion without a period."""
    return np.array([2.5 * np.sin(0.37 * index), 1.5 * np.cos(0.23 * index) - 1.5 + 0.01 * index])


class MatchingNetwork:
    """Follows points by plain correlation of small squares, to a pixel, as a network of modest skill would."""

    precision = "float32"

    def __init__(self, half=12, reach=12):
        self.half, self.reach = half, reach

    def follow(self, frames, queries):
        grey = frames.mean(axis=3).astype(np.float32)
        size = 2 * self.half + 1
        positions = np.empty((len(frames), len(queries), 2))
        seen = np.empty((len(frames), len(queries)))
        for index, query in enumerate(queries):
            u, v = np.rint(query).astype(int)
            template = grey[0, v - self.half : v + self.half + 1, u - self.half : u + self.half + 1]
            top, left = max(v - self.half - self.reach, 0), max(u - self.half - self.reach, 0)
            for frame, picture in enumerate(grey):
                window = picture[top : top + size + 2 * self.reach, left : left + size + 2 * self.reach]
                if template.shape != (size, size) or min(window.shape) < size:
                    positions[frame, index], seen[frame, index] = query, 0.0
                    continue
                _, best, _, place = cv2.minMaxLoc(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED))
                positions[frame, index] = query + np.array(place) + [left - u + self.half, top - v + self.half]
                seen[frame, index] = best
        return ChunkTracks(positions, seen, seen)

    def plan_frames(self, height, width):
        return None
