"""Parameter sweeps: experiments on many boards with varied plant, configuration and parameters."""
