"""The diagnosis on public recordings of real machines: what it answers, beside ordinary least squares on the same split."""
