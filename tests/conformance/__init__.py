"""Tests of the conformance battery: FMUs that are not as they should be."""
