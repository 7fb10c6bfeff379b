"""A text in the header of a PLY file."""


def add_ply_note(
    data: bytes,  # a PLY file
    note: str,
) -> bytes:
    """Return a PLY file with a text as a comment in its header; "" changes nothing.

    The header is ASCII, so that other characters become question marks.
    """
    if not note:
        return data
    first, second, rest = data.split(b"\n", 2)  # "ply" and the format
    line = " ".join(note.split()).encode("ascii", "replace")
    return b"\n".join([first, second, b"comment " + line, rest])
