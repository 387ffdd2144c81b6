"""Edits that know nothing of what the bytes mean: flipped, cut, doubled, strange ones put in."""

from random import Random

TOKENS = (
    b"\x00", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xef\xbb\xbf", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\n\n",
    b"\t", b"%", b"&a ", b"*a", b"<<", b"<!DOCTYPE x>", b"<![CDATA[", b"]]>", b"&#0;", b"&lt;", b"[" * 200, b"{",
    b'"', b"'", b"#", b"nan", b"1e999", b"-", b"9" * 400, b"PK\x03\x04", b"PAR1", b"ARROW1", b"\x1f\x8b",
)  # fmt: skip
LONGEST = 2_000_000  # bytes; doubling of doubled parts would go on and on


def edit(content: bytes, rng: Random) -> bytes:
    """One edit. The result may be empty."""
    if not content:
        return rng.choice(TOKENS)
    at, length = rng.randrange(len(content)), rng.choice((1, 2, 4, 8, 64, 1024))
    match rng.randrange(8):
        case 0:
            return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
        case 1:
            return content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]
        case 2:
            return content[:at]
        case 3:
            return content[:at] + content[at + length :]
        case 4 if len(content) < LONGEST:
            return content[: at + length] + content[at:]
        case 5:
            return content[:at] + rng.choice(TOKENS) + content[at:]
        case 6:
            token = rng.choice(TOKENS)
            return content[:at] + token + content[at + len(token) :]
        case _:
            other = rng.randrange(len(content))
            return content[:at] + content[other : other + length] + content[at + length :]
