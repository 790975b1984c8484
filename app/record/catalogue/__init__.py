"""Finished runs as a catalogue that can be queried: Rerun's own server over their recordings."""
