"""What decides, alike for every view: fit, select, ceiling, decide, hold out, resample. It knows no view by type."""
