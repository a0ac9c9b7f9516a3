BEGIN TRANSACTION;
CREATE TABLE events (
	id INTEGER NOT NULL, 
	session INTEGER NOT NULL, 
	kind VARCHAR(16) NOT NULL, 
	trial INTEGER NOT NULL, 
	at VARCHAR(32) NOT NULL, 
	text TEXT NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(session) REFERENCES sessions (id)
);
INSERT INTO "events" VALUES(1,1,'begin',0,'2026-11-21T12:14:07.246+00:00','');
CREATE TABLE haptorb_schema (
	version INTEGER NOT NULL, 
	PRIMARY KEY (version)
);
INSERT INTO "haptorb_schema" VALUES(1);
CREATE TABLE participants (
	id INTEGER NOT NULL, 
	study VARCHAR(16) NOT NULL, 
	code VARCHAR(16) NOT NULL, 
	ordinal INTEGER NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (study, code), 
	UNIQUE (study, ordinal), 
	FOREIGN KEY(study) REFERENCES studies (digest)
);
INSERT INTO "participants" VALUES(1,'87432234ffc10fc3','P01',0);
CREATE TABLE sessions (
	id INTEGER NOT NULL, 
	participant INTEGER NOT NULL, 
	"plan" TEXT NOT NULL, 
	simulated BOOLEAN NOT NULL, 
	started VARCHAR(32) NOT NULL, 
	ended VARCHAR(32), 
	aborted BOOLEAN NOT NULL, 
	versions TEXT NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (participant), 
	FOREIGN KEY(participant) REFERENCES participants (id)
);
INSERT INTO "sessions" VALUES(1,1,'{"participant": 0, "seed": [7, 0], "parts": [{"kind": "listed", "prompts": [{"phase": "practice", "condition": "base", "other": "", "set_point": 1, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 1, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 3, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 2, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 3, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 2, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}, {"phase": "main", "condition": "base", "other": "", "set_point": 1, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}]}]}',0,'2026-11-21T12:14:07.239+00:00',NULL,0,'{"haptorb": "0.1.0"}');
CREATE TABLE studies (
	digest VARCHAR(16) NOT NULL, 
	name VARCHAR(64) NOT NULL, 
	text TEXT NOT NULL, 
	PRIMARY KEY (digest)
);
INSERT INTO "studies" VALUES('87432234ffc10fc3','identify','
name = "identify"
[set_points]
points = [
  { number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36, phi_deg = 0 },
  { number = 3, theta_deg = 36, phi_deg = 180 },
]
[trials]
repetitions = 2
practice = 1
seed = 7
');
CREATE TABLE trials (
	id INTEGER NOT NULL, 
	session INTEGER NOT NULL, 
	number INTEGER NOT NULL, 
	prompt TEXT NOT NULL, 
	answer INTEGER, 
	x FLOAT, 
	y FLOAT, 
	z FLOAT, 
	seconds FLOAT NOT NULL, 
	safety TEXT NOT NULL, 
	recording TEXT, 
	answered VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (session, number), 
	FOREIGN KEY(session) REFERENCES sessions (id)
);
INSERT INTO "trials" VALUES(1,1,0,'{"phase": "practice", "condition": "base", "other": "", "set_point": 1, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}',1,0.0,0.0,0.05,1.5,'[]',NULL,'2026-11-21T12:14:07.247+00:00');
INSERT INTO "trials" VALUES(2,1,1,'{"phase": "main", "condition": "base", "other": "", "set_point": 1, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}',1,0.0,0.0,0.05,1.5,'[]',NULL,'2026-11-21T12:14:07.250+00:00');
INSERT INTO "trials" VALUES(3,1,2,'{"phase": "main", "condition": "base", "other": "", "set_point": 3, "level": 0.0, "interval": 0, "low": 0, "high": 0, "numbers": [1, 2, 3], "pause": 0.0}',1,0.0,0.0,0.05,1.5,'[]',NULL,'2026-11-21T12:14:07.251+00:00');
COMMIT;
