"""What-if over many boards: values of plant, configuration and parameters varied, figures of experiments as results."""
