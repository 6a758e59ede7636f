"""Groups of rows, one file each: a function that takes a Plan and yields a Row as soon as it is known."""
