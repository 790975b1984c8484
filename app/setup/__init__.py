"""What a run starts from: settings, inputs, outputs, versions."""
