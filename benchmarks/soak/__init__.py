"""A day of scans at full speed through decoder, tracker and alert, with everything going wrong in turn."""
