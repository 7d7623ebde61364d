"""The jobs that judge a filter: ours on a log, and an estimate or a trace that is handed in."""
