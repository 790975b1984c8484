"""What Rerun sees: a recorder for each thing that is recorded, and recordings read back."""
