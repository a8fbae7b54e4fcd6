"""Station keeping: the control law, the demonstration's vehicles, what happened in a run."""
