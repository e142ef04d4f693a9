"""The simulated chain: digitizer, firmware and bar. SIMULATED."""
