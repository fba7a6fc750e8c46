--
-- PostgreSQL database dump
--


-- Dumped from database version 15.18 (Debian 15.18-0+deb12u1)
-- Dumped by pg_dump version 15.18 (Debian 15.18-0+deb12u1)

SET statement_timeout = 0;
SET lock_timeout = 0;
SET idle_in_transaction_session_timeout = 0;
SET client_encoding = 'UTF8';
SET standard_conforming_strings = on;
SELECT pg_catalog.set_config('search_path', '', false);
SET check_function_bodies = false;
SET xmloption = content;
SET client_min_messages = warning;
SET row_security = off;

--
-- Name: anisoscope_refuse(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.anisoscope_refuse() RETURNS trigger
    LANGUAGE plpgsql
    AS $$
BEGIN RAISE EXCEPTION 'the history is append-only'; END $$;


SET default_tablespace = '';

SET default_table_access_method = heap;

--
-- Name: dispositions; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.dispositions (
    id bigint NOT NULL,
    inspection bigint NOT NULL,
    created_us bigint NOT NULL,
    reviewer text NOT NULL,
    decision text NOT NULL,
    comment text NOT NULL,
    previous bytea NOT NULL,
    hash bytea NOT NULL
);


--
-- Name: inspections; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.inspections (
    id bigint NOT NULL,
    created_us bigint NOT NULL,
    serial text NOT NULL,
    product text NOT NULL,
    recipe text NOT NULL,
    lot text,
    cavity text,
    station text,
    operator text,
    verdict text NOT NULL,
    reasons text NOT NULL,
    folder text NOT NULL,
    seal bytea NOT NULL,
    software text NOT NULL,
    layout bigint NOT NULL,
    numbers bytea NOT NULL,
    previous bytea NOT NULL,
    hash bytea NOT NULL
);


--
-- Name: layouts; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.layouts (
    id bigint NOT NULL,
    digest bytea NOT NULL,
    labels text NOT NULL
);


--
-- Name: schema_versions; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.schema_versions (
    version bigint NOT NULL,
    applied_us bigint NOT NULL
);


--
-- Data for Name: dispositions; Type: TABLE DATA; Schema: public; Owner: -
--

INSERT INTO public.dispositions VALUES (1, 3, 1795720911660511, 'R. R.', 'accept', 'burrs are allowed here', '\x0000000000000000000000000000000000000000000000000000000000000000', '\xdbaa285d6b817df0019a912b246c2b70a064b50dfe633df6c7ad384358c5da5c');
INSERT INTO public.dispositions VALUES (2, 3, 1795720911678382, 'Q', 'hold', '', '\xdbaa285d6b817df0019a912b246c2b70a064b50dfe633df6c7ad384358c5da5c', '\xcd1d9e6e3be21cce14841a4db172d28781f47b160ae949c7f194bd181063d5d6');


--
-- Data for Name: inspections; Type: TABLE DATA; Schema: public; Owner: -
--

INSERT INTO public.inspections VALUES (1, 1793512800000000, 'A0', 'ridged plate', '0123456789ab', 'L0', '0', 'east', 'M. M.', 'PASS', '["all is well","indeed"]', '/inspections/A0', '\x5feceb66ffc86f38d952786c6d696c79c2dbc239dd4e91b46729d73a27fb57e9', 'anisoscope 0.1.0', 1, '\x00000040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\x0000000000000000000000000000000000000000000000000000000000000000', '\xd8d6afd21dd17fe9d4b4da49a2e5e42e65387846500846364e7e1aa2cbda5cc1');
INSERT INTO public.inspections VALUES (2, 1793512860000000, 'A1', 'wafer', '0123456789ab', 'L1', '1', 'east', 'M. M.', 'PASS', '["all is well","indeed"]', '/inspections/A1', '\x6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b', 'anisoscope 0.1.0', 1, '\x62100040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xd8d6afd21dd17fe9d4b4da49a2e5e42e65387846500846364e7e1aa2cbda5cc1', '\xa4ca4978e19deda832e16b01bd35199b510e9267008dc1e66937caabc74332e6');
INSERT INTO public.inspections VALUES (3, 1793512920000000, 'A2', 'ridged plate', '0123456789ab', 'L2', '2', 'east', 'M. M.', 'FAIL', '["all is well","indeed"]', '/inspections/A2', '\xd4735e3a265e16eee03f59718b9b5d03019c07d8b6c51f90da3a666eec13ab35', 'anisoscope 0.1.0', 1, '\xc5200040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xa4ca4978e19deda832e16b01bd35199b510e9267008dc1e66937caabc74332e6', '\xc27a427ab5de5adbf3884aa9aa66df2b1a266aee086f65965d52914ac06a8818');
INSERT INTO public.inspections VALUES (4, 1793512980000000, 'A3', 'wafer', '0123456789ab', 'L0', '3', 'east', 'M. M.', 'INCONCLUSIVE', '["all is well","indeed"]', '/inspections/A3', '\x4e07408562bedb8b60ce05c1decfe3ad16b72230967de01f640b7e4729b49fce', 'anisoscope 0.1.0', 1, '\x27310040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xc27a427ab5de5adbf3884aa9aa66df2b1a266aee086f65965d52914ac06a8818', '\x0fba96a7a9f218f2c85430618aed324a2ca8d64c1ee91feef6eab2d685498f54');
INSERT INTO public.inspections VALUES (5, 1793513040000000, 'A4', 'ridged plate', '0123456789ab', 'L1', '0', 'east', 'M. M.', 'INVALID', '["all is well","indeed"]', '/inspections/A4', '\x4b227777d4dd1fc61c6f884f48641d02b4d121d3fd328cb08b5531fcacdabf8a', 'anisoscope 0.1.0', 1, '\x89410040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\x0fba96a7a9f218f2c85430618aed324a2ca8d64c1ee91feef6eab2d685498f54', '\xdab7767ef896422e3b1301ef75e60d44a34faacfd5a8f75513562dfb3ad8b213');
INSERT INTO public.inspections VALUES (6, 1793513100000000, 'A5', 'wafer', '0123456789ab', 'L2', '1', 'east', 'M. M.', 'PASS', '["all is well","indeed"]', '/inspections/A5', '\xef2d127de37b942baad06145e54b0c619a1f22327b2ebbcfbec78f5564afe39d', 'anisoscope 0.1.0', 1, '\xec510040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xdab7767ef896422e3b1301ef75e60d44a34faacfd5a8f75513562dfb3ad8b213', '\xc1bc298e3c8de98e23e0cafbd12569251a4e9087525a329521bb3ab2e0759097');
INSERT INTO public.inspections VALUES (7, 1793513160000000, 'A6', 'ridged plate', '0123456789ab', 'L0', '2', 'east', 'M. M.', 'PASS', '["all is well","indeed"]', '/inspections/A6', '\xe7f6c011776e8db7cd330b54174fd76f7d0216b612387a5ffcfb81e6f0919683', 'anisoscope 0.1.0', 1, '\x4e620040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xc1bc298e3c8de98e23e0cafbd12569251a4e9087525a329521bb3ab2e0759097', '\xdc8ced3aa591592e0da5f9a43915a369f7e208371eef232e6434bf31cd9f0997');
INSERT INTO public.inspections VALUES (8, 1793513220000000, 'A7', 'wafer', '0123456789ab', 'L1', '3', 'east', 'M. M.', 'FAIL', '["all is well","indeed"]', '/inspections/A7', '\x7902699be42c8a8e46fbbb4501726517e86b22c56a189f7625a6da49081b2451', 'anisoscope 0.1.0', 1, '\xb0720040cdcc4c3d0ad7a3bc0000803e9a99993fcdcc0c3f6f12833a', '\xdc8ced3aa591592e0da5f9a43915a369f7e208371eef232e6434bf31cd9f0997', '\x06f606d2f79476c15e8c4e0ba9ede748edf00db2eca56bc51fc443a69db9aaaf');
INSERT INTO public.inspections VALUES (9, 1793513280000000, 'A8', 'ridged plate', '0123456789ab', NULL, '0', 'east', 'M. M.', 'INCONCLUSIVE', '[]', '/inspections/A8', '\x2c624232cdd221771294dfbb310aca000a0df6ac8b66b696d90ef06fdefb64a3', 'anisoscope 0.1.0', 2, '\x26a6acaa04b67933000000000000e03f', '\x06f606d2f79476c15e8c4e0ba9ede748edf00db2eca56bc51fc443a69db9aaaf', '\xc54da4b4b0d20d34a14919015e967a8aa682d439b59058e637e1054e0e9c9af3');
INSERT INTO public.inspections VALUES (10, 1793513340000000, 'ü-9 漢', 'ridged plate', '0123456789ab', 'L0', '1', 'east', 'M. M.', 'INVALID', '["all is well","indeed"]', '/inspections/A9', '\x19581e27de7ced00ff1ce50b2047e7a567c76b1cbaebabe5ef03f7c3017bb5b7', 'anisoscope 0.1.0', 3, '\x', '\xc54da4b4b0d20d34a14919015e967a8aa682d439b59058e637e1054e0e9c9af3', '\xfbd15d122b7f5347f499ed6151df092626aad91fb762081af0800912df55aabb');


--
-- Data for Name: layouts; Type: TABLE DATA; Schema: public; Owner: -
--

INSERT INTO public.layouts VALUES (1, '\xec0ad00eb5ec3d08da3bfe3b3c508b51cec7b09073d7bd37fce445abfaffa331', '["ln 0-90","u ln 0-90","deviation ln 0-90","tolerance ln 0-90","d2","p","area share"]');
INSERT INTO public.layouts VALUES (2, '\xbbc2375ebaf35857ae4dd8ab60863127ecfe3051b13a6604e826ab719ab84048', '["d2","p"]');
INSERT INTO public.layouts VALUES (3, '\x4f53cda18c2baa0c0354bb5f9a3ecbe5ed12ab4d8e11ba873c2f11161202b945', '[]');


--
-- Data for Name: schema_versions; Type: TABLE DATA; Schema: public; Owner: -
--

INSERT INTO public.schema_versions VALUES (1, 1795720911339107);
INSERT INTO public.schema_versions VALUES (2, 1795720911368696);
INSERT INTO public.schema_versions VALUES (3, 1795720911372286);


--
-- Name: dispositions dispositions_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.dispositions
    ADD CONSTRAINT dispositions_pkey PRIMARY KEY (id);


--
-- Name: inspections inspections_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.inspections
    ADD CONSTRAINT inspections_pkey PRIMARY KEY (id);


--
-- Name: inspections inspections_seal_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.inspections
    ADD CONSTRAINT inspections_seal_key UNIQUE (seal);


--
-- Name: layouts layouts_digest_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.layouts
    ADD CONSTRAINT layouts_digest_key UNIQUE (digest);


--
-- Name: layouts layouts_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.layouts
    ADD CONSTRAINT layouts_pkey PRIMARY KEY (id);


--
-- Name: schema_versions schema_versions_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.schema_versions
    ADD CONSTRAINT schema_versions_pkey PRIMARY KEY (version);


--
-- Name: dispositions_by_inspection; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX dispositions_by_inspection ON public.dispositions USING btree (inspection);


--
-- Name: inspections_by_lot; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX inspections_by_lot ON public.inspections USING btree (lot, created_us);


--
-- Name: inspections_by_serial; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX inspections_by_serial ON public.inspections USING btree (serial);


--
-- Name: inspections_by_time; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX inspections_by_time ON public.inspections USING btree (created_us);


--
-- Name: inspections_by_verdict; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX inspections_by_verdict ON public.inspections USING btree (verdict, created_us);


--
-- Name: dispositions dispositions_refuse_delete; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER dispositions_refuse_delete BEFORE DELETE ON public.dispositions FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: dispositions dispositions_refuse_truncate; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER dispositions_refuse_truncate BEFORE TRUNCATE ON public.dispositions FOR EACH STATEMENT EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: dispositions dispositions_refuse_update; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER dispositions_refuse_update BEFORE UPDATE ON public.dispositions FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: inspections inspections_refuse_delete; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER inspections_refuse_delete BEFORE DELETE ON public.inspections FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: inspections inspections_refuse_truncate; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER inspections_refuse_truncate BEFORE TRUNCATE ON public.inspections FOR EACH STATEMENT EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: inspections inspections_refuse_update; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER inspections_refuse_update BEFORE UPDATE ON public.inspections FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: layouts layouts_refuse_delete; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER layouts_refuse_delete BEFORE DELETE ON public.layouts FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: layouts layouts_refuse_truncate; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER layouts_refuse_truncate BEFORE TRUNCATE ON public.layouts FOR EACH STATEMENT EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: layouts layouts_refuse_update; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER layouts_refuse_update BEFORE UPDATE ON public.layouts FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: schema_versions schema_versions_refuse_delete; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER schema_versions_refuse_delete BEFORE DELETE ON public.schema_versions FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: schema_versions schema_versions_refuse_truncate; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER schema_versions_refuse_truncate BEFORE TRUNCATE ON public.schema_versions FOR EACH STATEMENT EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: schema_versions schema_versions_refuse_update; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER schema_versions_refuse_update BEFORE UPDATE ON public.schema_versions FOR EACH ROW EXECUTE FUNCTION public.anisoscope_refuse();


--
-- Name: dispositions dispositions_inspection_fkey; Type: FK CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.dispositions
    ADD CONSTRAINT dispositions_inspection_fkey FOREIGN KEY (inspection) REFERENCES public.inspections(id);


--
-- Name: inspections inspections_layout_fkey; Type: FK CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.inspections
    ADD CONSTRAINT inspections_layout_fkey FOREIGN KEY (layout) REFERENCES public.layouts(id);


--
-- PostgreSQL database dump complete
--


