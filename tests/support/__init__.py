"""What tests run in: small projects, recordings, viewers, browsers, disturbances."""
