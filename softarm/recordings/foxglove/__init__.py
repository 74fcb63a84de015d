"""Logs in Foxglove's message types as JSON: frames, a scene, plots and events.

The schemas (`schemas/*.json`) are those of @foxglove/schemas 2.1, MIT: `schemas/LICENSE`.
"""
