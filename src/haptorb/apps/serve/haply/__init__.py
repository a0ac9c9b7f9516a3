"""`--serve haply`: the Inverse Service's protocol, so that programs written for that service feel this device."""
