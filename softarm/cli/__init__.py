"""The `softarm` command: one small file per verb group, imported when the verb is used."""
