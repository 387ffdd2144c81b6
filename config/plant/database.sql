-- The first start of the plant's PostgreSQL: the user of the services owns one database and nothing else.
\set password `cat /run/secrets/sweepid-password`
CREATE ROLE sweepid LOGIN PASSWORD :'password';
CREATE DATABASE sweepid OWNER sweepid ENCODING 'UTF8' TEMPLATE template0;
REVOKE CONNECT ON DATABASE sweepid FROM PUBLIC;
