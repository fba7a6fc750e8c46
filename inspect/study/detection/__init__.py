"""The detection study: false alarms, power, and coverage of severities."""
