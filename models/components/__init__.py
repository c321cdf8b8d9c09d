"""The components: each module declares one `MODEL`, of which the FMU is built."""
