"""What the shell scripts run."""
