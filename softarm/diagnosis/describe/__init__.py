"""Description of a rig's recordings: what their columns are, as a commented stage.yaml."""
