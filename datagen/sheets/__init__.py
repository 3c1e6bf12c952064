"""Pages that show a data set or a models folder to somebody who has to confirm it."""
