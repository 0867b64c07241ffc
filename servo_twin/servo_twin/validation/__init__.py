"""What checks the servo: experiments with bounds, campaigns, timing, and sweeps. The product does not import it."""
