"""Changed bytes, and check sums made right again, without which few changes would be looked at."""

import random
import struct
import zlib
from collections.abc import Callable, Sequence

TOKENS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e-320", b"9" * 400, b"1_0", b"NaN",
    b"Infinity", b"null", b"true", b"{}", b"[]", b'""', b"[" * 2000, b'{"a":' * 2000, b"..",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"\n", b"\r", b"\x85", b"#", b" ", b"\x1c", b"2e9",
    b"/", b"../../x", b"99999", b"100000000", b"(1,)", b"(99999, 99999)", b"'|O'", b"'<f8'",
    b"'<U9'", b"True", b"PF\n9999 9999\n-1\n", b"IHDR", b"IDAT", b"IEND", b"tEXt", b"zTXt",
    b"acTL", b"PLTE", b"tRNS", b"PK\1\2", b"PK\3\4", b"\x93NUMPY\1\0", b"\x93NUMPY\2\0",
    b"moov", b"trak", b"RIFF", b"idx1",
)  # fmt: skip
WHOLE = (0, 1, 2, 7, 127, 128, 255, 256, 32767, 32768, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
_LONGEST = 64 * 1024

Change = Callable[[bytearray, random.Random], bytes | bytearray]


def mutated(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return a changed copy, most often with check sums that are right."""
    found: bytes | bytearray = bytearray(data)
    for _ in range(1 + int(rng.expovariate(0.7))):
        if rng.random() < 0.05:
            found = _joined(bytearray(found), rng.choice(others), rng)
        else:
            found = rng.choice(_CHANGES)(bytearray(found), rng)
    found = bytes(found[:_LONGEST])
    return repaired(found) if rng.random() < 0.8 else found


def _place(data: bytearray, rng: random.Random) -> int:
    # Headers are at the beginning or, of a ZIP, at the end.
    where = rng.random()
    if where < 0.3:
        return rng.randrange(min(len(data), 64) + 1)
    if where < 0.4:
        return max(0, len(data) - rng.randrange(200))
    return rng.randrange(len(data) + 1)


def _flip(data: bytearray, rng: random.Random) -> bytearray:
    place = _place(data, rng)
    if place < len(data):
        data[place] ^= 1 << rng.randrange(8)
    return data


def _byte(data: bytearray, rng: random.Random) -> bytearray:
    place = _place(data, rng)
    if place < len(data):
        data[place] = rng.randrange(256)
    return data


def _number(data: bytearray, rng: random.Random) -> bytearray:
    place, size = _place(data, rng), rng.choice((1, 2, 4, 8))
    value = rng.choice(WHOLE) & (256**size - 1)
    data[place : place + size] = value.to_bytes(size, rng.choice(("big", "little")))
    return data


def _token(data: bytearray, rng: random.Random) -> bytearray:
    place, token = _place(data, rng), rng.choice(TOKENS)
    data[place : place + rng.choice((0, len(token)))] = token
    return data


def _word(data: bytearray, rng: random.Random) -> bytearray:
    """Replace a run of letters and digits, such as a number of a text."""
    place = _place(data, rng)
    start = end = min(place, len(data))
    while start and chr(data[start - 1]).isalnum() and place - start < 20:
        start -= 1
    while end < len(data) and chr(data[end]).isalnum() and end - place < 20:
        end += 1
    data[start:end] = rng.choice(TOKENS)
    return data


def _cut(data: bytearray, rng: random.Random) -> bytearray:
    del data[_place(data, rng) :]
    return data


def _remove(data: bytearray, rng: random.Random) -> bytearray:
    place = _place(data, rng)
    del data[place : place + rng.randrange(1, 40)]
    return data


def _repeat(data: bytearray, rng: random.Random) -> bytearray:
    place = _place(data, rng)
    part = data[place : place + rng.randrange(1, 60)]
    data[place:place] = part * rng.choice((1, 1, 2, 50))
    return data


def _joined(data: bytearray, other: bytes, rng: random.Random) -> bytearray:
    return data[: _place(data, rng)] + other[rng.randrange(len(other) + 1) :]


_CHANGES: tuple[Change, ...] = (
    _flip, _byte, _byte, _number, _number, _token, _word, _cut, _remove, _repeat,
)  # fmt: skip


def repaired(data: bytes) -> bytes:
    """Return a PNG or ZIP with right check sums, as far as its parts are found; others as is."""
    found = bytearray(data)
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        _repair_png(found)
    elif data.startswith(b"PK"):
        _repair_zip(found)
    return bytes(found)


def _repair_png(data: bytearray) -> None:
    position = 8
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 8 + length
        if end + 4 > len(data):
            return
        struct.pack_into(">I", data, end, zlib.crc32(data[position + 4 : end]))
        position = end + 4


def _repair_zip(data: bytearray) -> None:
    position = data.find(b"PK\1\2")
    while position >= 0 and position + 46 <= len(data):
        packing, size, where = (
            struct.unpack_from(kind, data, position + offset)[0]
            for kind, offset in (("<H", 10), ("<I", 20), ("<I", 42))
        )
        if packing == 0 and where + 30 <= len(data):
            name, more = struct.unpack_from("<HH", data, where + 26)
            start = where + 30 + name + more
            check = zlib.crc32(data[start : start + size])
            struct.pack_into("<I", data, position + 16, check)
            struct.pack_into("<I", data, where + 14, check)
        position = data.find(b"PK\1\2", position + 4)
