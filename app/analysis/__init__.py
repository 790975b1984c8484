"""What is computed of finished runs: figures against the truth, differences, faults."""
