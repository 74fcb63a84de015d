"""The first hour with a drive: its zero found, the middle of the rail found. Tools of a person's, beside no daemon."""
