"""What each process of the service has: settings, logs, tasks, telemetry."""
