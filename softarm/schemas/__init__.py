"""Data that crosses a border: configuration, messages, REST bodies, log channels. No behaviour."""
