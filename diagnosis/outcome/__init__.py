"""What comes of it: verdict, closure, the answer as data, the next run, what is adopted."""
