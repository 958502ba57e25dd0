"""What others do with a fabric under many lights: fitted for the chart, but never rendered."""
