"""Work of the identification process, begun and begun again; the outbox of recorded sweeps."""
