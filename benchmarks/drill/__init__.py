"""The fault drill: one small scenario, played while things break; see `benchmarks.fault_drill`."""
