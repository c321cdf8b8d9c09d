"""What all tests need."""

import signal

# a shell that starts the tests in the background has SIGINT ignored; tests that press Ctrl-C need it as it is at a terminal
signal.signal(signal.SIGINT, signal.default_int_handler)
