"""What the files of a run are called."""

RUN, SIGNALS, LIVE, CSV = "run.toml", "signals.parquet", "signals.arrow", "signals.csv"
CHECKPOINT = "checkpoint.zip"
ASIDE = "before-"
"""How the name of the signals of a run begins while it is being taken up again."""
