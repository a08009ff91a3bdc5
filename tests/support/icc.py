"""Colour profiles (ICC, version 4) for tests: the curve of sRGB with three primary colours."""

import struct

# X, Y and Z of the primary colours, adapted to D50 as profiles have them
SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))
DISPLAY_P3 = (
    (0.51512, 0.24120, -0.00105),
    (0.29198, 0.69225, 0.04189),
    (0.15710, 0.06657, 0.78407),
)
D50 = (0.9642, 1.0, 0.8249)


def profile(primaries=DISPLAY_P3, numbers=None) -> bytes:
    """Return a profile of a screen with these primary colours; numbers: four of H.273, or None."""
    curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0)
    curve += b"".join(map(_fixed, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))
    text = "Test".encode("utf-16-be")
    name = b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(text), 28) + text
    tags = {b"desc": name, b"cprt": name, b"wtpt": _xyz(D50)}
    for letter, color in zip(b"rgb", primaries, strict=True):
        tags[bytes([letter]) + b"XYZ"] = _xyz(color)
        tags[bytes([letter]) + b"TRC"] = curve
    if numbers is not None:
        tags[b"cicp"] = b"cicp" + bytes(4) + bytes(numbers)
    table, body = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    for key, data in tags.items():
        table += key + struct.pack(">II", start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    whole = 128 + len(table) + len(body)
    head = struct.pack(">I4sI4s4s4s", whole, bytes(4), 0x04300000, b"mntr", b"RGB ", b"XYZ ")
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28)
    head += b"".join(map(_fixed, D50))
    return head + bytes(128 - len(head)) + table + body


def _fixed(value):
    return struct.pack(">i", round(value * 65536))


def _xyz(color):
    return b"XYZ " + bytes(4) + b"".join(map(_fixed, color))
