"""What a drive does at points: forms, levels over sampled fingers and bars, envelopes, rise times."""
