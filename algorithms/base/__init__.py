"""What all steps share: scans, labels, rigid transforms, trajectories, segments seen from above, the settings' base class."""
