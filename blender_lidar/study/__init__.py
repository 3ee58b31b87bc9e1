"""What mountings are worth on a scene: scoring, search runs, intervals, and where the scores can be trusted."""
