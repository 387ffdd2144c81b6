"""TLS of one connection, in memory: the socket stays plain, and nothing blocks."""

import ssl

HANDSHAKE = b"\x16"  # first byte of TLS; no HTTP method begins with it
_PIECE = 65536  # bytes


class Secured:
    """The server side."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._coming, self._going = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._coming, self._going, server_side=True)

    def read(self, data: bytes) -> tuple[bytes, bytes]:
        """Decrypted bytes, and bytes to send now during the handshake. ssl.SSLError."""
        self._coming.write(data)
        said = bytearray()
        try:
            while piece := self._tls.read(_PIECE):
                said += piece
        except (ssl.SSLWantReadError, ssl.SSLZeroReturnError):
            pass
        return bytes(said), self._going.read()

    def write(self, words: bytes) -> bytes:
        """The bytes encrypted for the wire. ssl.SSLError."""
        self._tls.write(words)
        return self._going.read()
