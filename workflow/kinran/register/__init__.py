"""Registration: side views of a fabric brought to its front view through its height."""
