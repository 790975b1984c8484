"""What all steps share: scans, labels, transforms, trajectories, faces seen from above."""
