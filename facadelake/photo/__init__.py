"""What a photograph says of itself: files, EXIF and XMP, position and attitude priors."""
