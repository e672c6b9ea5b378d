"""What a photograph says of itself: EXIF and XMP, camera models, position and attitude priors."""
