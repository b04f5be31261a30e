"""What disturbs a measurement and is no effect to be named: rounding of commands and logs, ripple, scatter."""
