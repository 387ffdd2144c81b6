"""Jobs of the identification process and their repetition; the outbox of recorded sweeps."""
