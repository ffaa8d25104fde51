"""Tools beside the loop: doctor, download guides, calibration, a look at a recording before a run, leaderboards."""
