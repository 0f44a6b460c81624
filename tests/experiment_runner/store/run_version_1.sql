PRAGMA application_id=1196184901;
PRAGMA user_version=1;
BEGIN TRANSACTION;
CREATE TABLE checkpoints (
            trial INTEGER PRIMARY KEY REFERENCES trials,
            episode INTEGER NOT NULL,
            agent BLOB NOT NULL,
            environment BLOB NOT NULL);
INSERT INTO "checkpoints" VALUES(1,2,X'0102',X'');
CREATE TABLE episodes (
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL CHECK (episode >= 1),
            episode_return REAL,
            steps INTEGER NOT NULL,
            terminal INTEGER NOT NULL CHECK (terminal IN (0, 1)),
            wall_time REAL NOT NULL,
            PRIMARY KEY (trial, episode)) WITHOUT ROWID;
INSERT INTO "episodes" VALUES(1,1,1.5,100,1,0.25);
INSERT INTO "episodes" VALUES(1,2,-10.25,20,0,0.125);
CREATE TABLE events (
            time REAL NOT NULL,
            trial INTEGER REFERENCES trials,
            kind TEXT NOT NULL,
            text TEXT NOT NULL);
INSERT INTO "events" VALUES(1000000000.25,NULL,'start','glue-rl 0.1.0');
INSERT INTO "events" VALUES(1000000001.0,2,'joined','agent Jumper (Python 3.11) joined');
INSERT INTO "events" VALUES(1000000002.0,2,'joined','agent My (old) agent joined (RL-Glue C codec) joined');
INSERT INTO "events" VALUES(1000000003.0,2,'joined','environment mario joined');
INSERT INTO "events" VALUES(1000000004.0,2,'joined','somebody');
CREATE TABLE trials (
            key INTEGER PRIMARY KEY,
            id TEXT NOT NULL UNIQUE,
            agent TEXT,
            environment TEXT,
            episodes INTEGER NOT NULL,
            max_steps INTEGER NOT NULL,
            seed INTEGER NOT NULL,
            failure TEXT);
INSERT INTO "trials" VALUES(1,'random/level_seed=121/mario/0','{"name": "random", "options": {"speed": 0.5}, "label": "random"}','{"name": "mario", "options": {"level_seed": 121}, "label": "mario"}',2,0,9223372036854775807,NULL);
INSERT INTO "trials" VALUES(2,'remote/mario/1',NULL,'{"name": "mario", "options": {}, "label": "mario"}',3,1000,7,'it raised ValueError');
CREATE TABLE voids (
            time REAL NOT NULL,
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL,
            why TEXT NOT NULL);
INSERT INTO "voids" VALUES(1000000000.5,1,2,'the agent was lost');
COMMIT;
