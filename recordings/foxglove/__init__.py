"""Logs as Foxglove shows them: frames, a scene, plots and what happened, in Foxglove's own message types as JSON.

The types' schemas (`schemas/*.json`) are those of @foxglove/schemas 2.1, MIT: `schemas/LICENSE`.
"""
