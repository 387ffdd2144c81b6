"""TLS of one connection, in memory: the socket beside it stays what it was, and nothing is waited for."""

import ssl

HANDSHAKE = b"\x16"  # begins TLS; no method of HTTP does
_PIECE = 65536  # bytes


class Secured:
    """The server's end."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._coming, self._going = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._coming, self._going, server_side=True)

    def read(self, data: bytes) -> tuple[bytes, bytes]:
        """What bytes of the wire say, and what is to be sent now, while hands are shaken. ssl.SSLError."""
        self._coming.write(data)
        said = bytearray()
        try:
            while piece := self._tls.read(_PIECE):
                said += piece
        except (ssl.SSLWantReadError, ssl.SSLZeroReturnError):
            pass
        return bytes(said), self._going.read()

    def write(self, words: bytes) -> bytes:
        """As they go on the wire. ssl.SSLError."""
        self._tls.write(words)
        return self._going.read()
